"""The measuring instrument for relations: scenes whose true graph is known, rows from trivial to taught, scores.

Begin with `relations.run`. `families` says what is tested, `rows` who takes the test, `scores` how it is marked.

Scenes on two lanes have files of their own, `lane_*.py`; begin with `lanes.run_lanes`. Both share `resumable_jobs`.
"""
