"""The baselines (Sec. VI-A): NRI, Supervised, and a calibrated intelligent driver model.

`nri.train_nri` and `supervised.train_supervised` train a model in place, each with its settings. `idm.calibrate` fits
the IDM to recorded scenes, and `idm.drive` simulates it. Begin reading with `supervised`, the shortest.
"""
