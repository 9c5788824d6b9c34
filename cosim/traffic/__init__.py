"""The traffic that SUMO is started with: `route_file` writes demand, `replay` moves recorded vehicles."""
