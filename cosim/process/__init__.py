"""Processes and the terminal: workers that isolate crashes, forks of the simulation, progress, output."""
