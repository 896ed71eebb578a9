"""The demo: its ``scene``, the ``chain`` from motion to restored photos, and their ``page``."""
