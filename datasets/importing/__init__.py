"""Import of recordings that others made: bags, HDF5, zarr -> the episodes of a run.

- `config` what an `import.yaml` says; `survey` what a recording holds, and a first `import.yaml`
- `recording` one interface to bags, implemented by `mcap_file`, `sqlite_file`, `bag1_file`, joined
  by `joined`; `sources` finds out what a path is
- `decoding` bytes to messages for each encoding, `values` messages to arrays, `pictures` and
  `video` to pixels, `transforms` frames to poses
- `sampler` which message each frame takes, `faults` what went wrong on the way, `segments` where
  episodes start and stop, `limits` which of them are refused
- `bag_steps` and `array_steps` give the steps of one episode; `array_formats` reads HDF5 and zarr
- `run` plans, resumes, writes; `bench` makes big bags and measures
"""
