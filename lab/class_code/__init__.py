"""One shutter code for a class of motions, by its mean decibels over them."""
