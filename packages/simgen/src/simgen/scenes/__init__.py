"""What a dataset consists of before it is rendered: jobs, identities, simulated and published poses."""
