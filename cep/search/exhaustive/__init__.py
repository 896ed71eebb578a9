"""Every code counted out, and the best one proven."""
