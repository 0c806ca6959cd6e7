"""Identification of a servo's gains, latency and motor from recordings, with uncertainties."""
