"""The BOP benchmark (Hodaň et al. 2018): its datasets, object models and results files in, our frames out."""
