"""The GAUGE dataset of real trials: download it, import it, and what the import leaves in the user's data folder.

- `layout`: finds the trial files of a dataset folder and the variant that each is of, whatever its folders spell.
- `trial`: reads and checks one trial file.
- `observation`: g(t) and the driver's coordinates of a trial, by the observers that simulations are read with.
- `statistics`: mean, scatter and baselines over trials, one trial in memory at a time.
- `store`: imported bands and drivers in the user's data folder.
- `importer`: all of these, one variant after another.
- `status`: what each variant is scored against and driven by.
- `download`: fetches the dataset from its host.

Nothing is imported here, as `gauge_envs.references.bands` reads the store and must stay light.
"""

__all__: list[str] = []
