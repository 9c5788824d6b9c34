"""Recordings of any layout as one tidy table, and from there to scenes.

`table` says what the tidy table is: one row per vehicle and time, SI units. A *layout* is the form in which a data set
is published (`highd`, `exid`, `interaction`, `tgsim`, `i24`), or that of SUMO's FCD output (`sumo_fcd`), of a run
folder (`run_folder`) or of the tidy table itself (`tidy`); each has a module that turns a file into `parts`.
`layouts` finds the layout of a file. `files` opens what a person has: files, folders, gzip, zip. `road_axis` and
`lanes` turn positions in a plane into positions along a road and lanes; `clock` turns times into frames of 0.1 s.

Other rooms use `reading.open_recordings`, whose recordings are those of `gri.data.ngsim`, so that all that follows
(defects, smoothing, search for scenes) is the same for every layout, and `scenes`. Begin reading with `reading`.
"""
