"""The GAUGE dataset of real trials: download, import and status.

- `download`: download the dataset.
- `layout`: find the trial files of a dataset folder and the variant of each.
- `trial`: read and check one trial file.
- `findings`: describe problems of a file or folder.
- `observation`: compute g(t) and the prescribed motion of a trial, by the observers of simulations.
- `statistics`: compute mean, scatter and distances of trials.
- `importer`: import a dataset folder, one variant after another.
- `report`: show imports, and the reference and prescribed motions of each variant.

`gauge_envs.references.imported` stores and reads the imported bands and prescribed motions.
"""
