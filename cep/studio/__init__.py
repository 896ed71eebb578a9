"""Studio: a page on this computer on which codes are dragged, searched, compared and played."""
