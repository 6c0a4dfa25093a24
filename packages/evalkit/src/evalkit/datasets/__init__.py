"""What a scene, a view and a dataset are, on disk and in memory: shards (HDF5), gt.json and preds.json."""
