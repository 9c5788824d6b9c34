"""From which ranges scenes are drawn: starts, graphs, leaders; one file per kind of scene."""
