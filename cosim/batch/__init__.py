"""Many runs from one YAML file, each in a process of its own; resumable. Begin with `execute`."""
