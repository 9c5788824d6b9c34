"""The closed loop: observe, infer, act, command, judge, hand back.

Begin with `closed_loop.run` (a whole run), then `driving.drive` (one round of groups).
"""
