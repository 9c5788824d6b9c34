"""Synthetic scenes: `expert` trains a policy on the true reward, `optimal_drivers` plays best responses."""
