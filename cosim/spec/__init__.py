"""The YAML files of scenarios: their types, how they are read and checked, and the files that they name.

`scenario` is the whole file, `demand` its traffic and `perturbations` its perturbations. `loading` reads a scenario by
name or path; `input_files` finds and hashes the net, checkpoint, policy and recording that it names. This room imports
neither SUMO nor torch, and every room above uses it. Begin with `scenario.Scenario` and `loading.load_scenario`.
"""
