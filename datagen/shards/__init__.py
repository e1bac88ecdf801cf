"""Recording on several machines that share a folder: a plan, leases, and one function for a shard.

```
RUN/shards/plan.json         which scenes make which shard, and how they are recorded
RUN/shards/leases/0003.json  who works on a shard, and until when
RUN/shards/done/0003.json    what came of it, with a checksum
```
What an episode holds follows from its scene and the plan alone, and its folder appears whole. So a
shard that two workers run, because a lease ran out too soon, still gives every episode once.
"""
