"""Drivers that a regulation or a publication describes, as benchmarks for cut-ins: UN Regulation 157, FSM and RSS.

They say which collisions a careful driver would have avoided; they certify nothing. Begin with `drivers`, which judges
a situation and says how hard to brake. `reaction` adds the time that passes before the brake acts. `cut_in_grid` drives
them, and any speed control, through a grid of cut-ins; `policy_in_grid` drives a policy of the project through the
same grid. docs/cut-ins.md describes the results.
"""
