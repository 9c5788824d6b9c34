"""Stress tests: policies under graded perturbations, on the same starts. Begin with `stress_test.run_stress`."""
