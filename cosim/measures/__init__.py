"""Metrics and statistics: pure functions of arrays, without SUMO.

`collision_detection` is the collision test (oriented boxes). `surrogate_safety` has TTC, DRAC, PET, headways and jerk
of one drive. `relation_labels` labels which vehicle reacts to which, and `label_agreement` compares such labels.
`statistics` has confidence intervals and paired tests. Every room above may use all of it. Begin with
`surrogate_safety.conflicts`, which gives the safety measures of one drive.
"""
