"""The rewards of driving: named terms per edge type and their weighted sum (Sec. IV, VI-C, VI-D).

Begin with `terms`: it lists every term of every scenario, with the function that computes it. The formulas are in
`car_following_features` and `lane_changing_features` (synthetic scenes, e.g. `g_yield`, the reward for yielding) and in
`recorded_traffic_features` (with learned reference networks). `learned_constants` makes the constants of car following
parameters. `structured.StructuredReward` sums the terms; other rooms use it and the configurations in `terms`.
`unstructured` has the rewards without terms, for the ablations of Appendix C.
"""
