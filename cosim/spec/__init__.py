"""The types of the YAML files, and how they are read and checked. Begin with `scenario.Scenario`."""
