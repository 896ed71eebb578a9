"""Studio: a page on this machine on which codes are dragged, searched, compared, exported and
played.
"""
