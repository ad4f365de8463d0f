"""Many runs: jobs, their records on disk, and the processes that work them off."""
