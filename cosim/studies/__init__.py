"""Traffic with nobody taken over, held against recordings: targets, calibration, realism."""
