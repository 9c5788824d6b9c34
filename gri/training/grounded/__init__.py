"""Grounded training without an adversary: reward, then graph, then policy. Begin with `train_grounded`."""
