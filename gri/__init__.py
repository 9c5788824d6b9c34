"""Grounded Relational Inference: graphs of relations between vehicles, and policies that obey them."""
