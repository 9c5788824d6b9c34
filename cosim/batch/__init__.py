"""Batches: many runs from one YAML file, each in a process of its own; a stopped batch can be continued.

`spec` is the YAML file; `run_matrix` expands it into single runs; `execute` runs what is left, by `run_task`, and
records the results with `store`; `group_statistics` computes rates, means and paired differences over the groups of all
runs, and `result_listing` shows them in the terminal. Other rooms use `store.BatchStore` to read a batch, and the
measures of `group_statistics`. Begin with `execute.execute`.
"""
