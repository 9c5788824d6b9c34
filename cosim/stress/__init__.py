"""Stress tests: policies under graded perturbations, on the same starts."""
