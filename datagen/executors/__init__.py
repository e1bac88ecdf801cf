"""Where shards run: in processes of this machine, on a Ray cluster, or as Slurm jobs."""
