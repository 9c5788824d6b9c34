"""From NGSIM trajectory files to a scene file.

The steps are: read a file (`reading`), separate its recordings (`recordings`), repair and count defects (`defects`),
smooth the tracks (`smoothing`), search for car-following triples (`car_following`) and lane-changing groups
(`lane_changing`) by `rules`, and write them (`extract`). Other rooms use `extract.extract`, `extract.inspect` and
`extract.scene_file`; `cosim` also uses `recordings`, `clean` and `smoothed` to replay a recording. Begin reading with
`extract`.
"""
