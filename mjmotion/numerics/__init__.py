"""Mathematics that knows no body: rotations, ⊕ and ⊖, B-splines, smooth curves."""
