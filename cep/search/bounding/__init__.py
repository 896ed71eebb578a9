"""What no code can exceed."""
