"""HTML pages that report a result."""
