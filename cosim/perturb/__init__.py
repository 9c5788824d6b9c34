"""Perturbations of a scenario: what they are (`specs`) and what each of them changes."""
