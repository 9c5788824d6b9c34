"""The paper's tables and figures: rows as data, trained and tested as cached jobs, beside the published figures.

Others use `plan.Plan` and `publish.publish`. Begin reading there: `rows` lists scenarios and rows, `run_jobs` trains
and tests them, `score_frames` collects the results, `pages` and `figures` show them.
"""
