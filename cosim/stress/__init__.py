"""Stress tests: several policies drive the same starts under graded perturbations.

`plan` splits a stress test into chunks, each with one simulation. `chunk` runs a chunk: at every round, each policy
drives each cell (perturbation and intensity) in a branch of its own. `result_rows` makes one row per drive. `estimates`
computes values with intervals and paired differences; `report` and `figures` show them; `merge_outcomes` counts merges
without contact. The command `cosim stress` uses `plan` and `stress_test`; no other room imports this one. Begin with
`stress_test.run_stress`.
"""
