"""The classical blind search of a blur kernel, from coarse to fine (PMP), in torch."""
