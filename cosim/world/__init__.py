"""The world as values: snapshots of vehicles, the road frame, groups, episodes.

Nothing here talks to SUMO. Begin with `snapshot.Snapshot` (what is read) and `episode.Episode` (what a drive gives).
"""
