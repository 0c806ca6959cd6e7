"""Forecast of what policies will do on the real robot, before they swim there."""
