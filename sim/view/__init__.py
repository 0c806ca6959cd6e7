"""Pictures, videos and report pages of simulations."""
