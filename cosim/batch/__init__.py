"""Batches: many closed-loop runs from one YAML file, each in a process of its own."""
