"""The world as values: snapshots of all vehicles, the road frame, groups, episodes. Nothing here talks to SUMO."""
