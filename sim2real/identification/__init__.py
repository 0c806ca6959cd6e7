"""A servo's gains, latency and motor from recordings of one joint, and how well they are known."""
