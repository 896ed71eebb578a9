"""Tables of published shutter codes, that of deep coded exposure among them."""
