"""Grounded Relational Inference: graphs of semantic relations between vehicles, and policies that obey them."""
