"""A body and its motion: what a character is, how it is placed, and what it can do."""
