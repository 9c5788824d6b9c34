"""From NGSIM's files to a scene file: read, sort, repair, smooth, search for groups. Begin with `extract`."""
