"""Studies of undisturbed traffic: how close simulated traffic is to recorded traffic.

`traffic_targets` compares the speed and flow of a simulation with the targets of its scenario; `calibration` searches
driver and bottleneck parameters that reach them. `traffic_samples` reads samples from recordings and runs; `realism`
computes distances between their distributions, and `realism_report` and `distribution_plots` show them. The commands
`cosim traffic`, `calibrate` and `realism` use this room; no other room does. Begin with `calibration.calibrate` or
`realism.distances`.
"""
