"""The batch in the shape of libraries that learn with torch: TorchRL, BenchMARL."""
