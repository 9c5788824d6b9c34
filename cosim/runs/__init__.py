"""One run and its folder: load the policy, run the loop, write tables, manifest and picture. Begin with `run_job`."""
