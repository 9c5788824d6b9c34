"""Training scenes cut out of live traffic, with the relations that SUMO knows (docs/scene-labels.md).

Begin with `dataset.make`; `seed_scenes` runs one seed, `trajectory_buffer` holds the last seconds of traffic.
"""
