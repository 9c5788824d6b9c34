"""Graphs of a user's own scenes: who follows, yields to or cuts in on whom, in every step.

Begin with `gri.inference.step_relations`; `gri infer` is the command.
"""
