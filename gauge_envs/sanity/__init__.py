"""The sanity check of a training configuration: which physics it gets wrong, and which setting is responsible."""
