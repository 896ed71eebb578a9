"""Motion with its order in time, from photos of one motion taken through known codes."""
