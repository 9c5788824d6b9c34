"""The closed loop: observe, decide, command, step, judge, hand back.

`closed_loop.run` is a whole run. `trunk` is the undisturbed traffic in which groups are found; `trunk_courses` lets
several runs share it. `driving.drive` is the loop that drives one round of groups, in one of the `branches`.
`take_over_and_hand_back` says how vehicles change hands, `policy_runner` how a policy is called, `round_recorder` how a
drive ends, `intervention` what perturbations do.
Others use `run`, `drive`, `Driver` and `Trunk`. Begin with `closed_loop`, then `driving`.
"""
