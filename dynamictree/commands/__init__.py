"""The commands of the pipeline, a module each. Those of data set and training stand in their own packages."""
