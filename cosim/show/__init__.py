"""Showing results: an episode as video, animation, text or in sumo-gui, and the HTML report of a batch.

`episode_view.episode_view` reads one episode from the tables of a run; `video`, `animation`, `explanation` and
`sumo_gui` show it. `batch_report` is the HTML page of a batch, with charts (`svg_charts`), inferred graphs
(`graph_drawing`) and the `worst_episodes`; its HTML, CSS and JavaScript are in `templates/`. The commands `cosim
render`, `explain`, `gui` and `report` use these modules; no other room imports this one. Begin with `episode_view`.
"""
