"""From a job to a folder of shards: build, resume, verify, repair."""
