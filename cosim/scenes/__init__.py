"""Training scenes out of live traffic, with the relations that the simulator knows (docs/scene-labels.md)."""
