"""One model from one configuration. Begin with `train.train`, which calls the objective the configuration names."""
