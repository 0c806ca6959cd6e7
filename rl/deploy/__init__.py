"""Deployment of policies: exports, radio, pilot."""
