"""Second look at a certificate, with arithmetic of its own: nothing here imports what made it."""
