"""Scenes of every origin: synthetic ones, and those read from scene files of recorded or simulated traffic.

Begin with `store`, which gives a configuration its scenes.
"""
