"""The graph of each step of a scene: who follows, yields to or cuts in on whom, in files of any user.

Begin with `gri.inference.step_relations`; `gri infer` is the command.
"""
