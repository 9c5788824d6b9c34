"""Scenes from every origin: synthetic ones, and those of scene files from recorded or simulated traffic.

`store.scenes_of` returns the training, validation and test scenes (`gri.core.scenes.Scenes`) of a configuration; that
is what training and evaluation use. `recorded` reads scene files for a model, `export` writes synthetic scenes to a
scene file, `mixture` joins both kinds. The inner rooms are `ranges` (what scenes of one kind have in common),
`synthetic` (making scenes), `scene_file` (the file format), `ngsim` (extracting scenes from recordings) and
`recordings` (reading recordings of any layout). Begin reading with `store`.
"""
