"""The baselines: NRI, Supervised, and a calibrated intelligent driver model."""
