"""What teams did: metrics, clogs, figures and reports, from frames as they come."""
