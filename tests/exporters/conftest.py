import pytest


@pytest.fixture(autouse=True)
def brief(monkeypatch):
    """A standard excitation of six seconds, as refits take most of the time of these tests."""
    monkeypatch.setattr("sim2real.exporters.excitation.SECONDS", 6.0)
