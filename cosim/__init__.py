"""Closed-loop co-simulation with SUMO."""
