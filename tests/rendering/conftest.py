from tests.reporting.conftest import hac, hostile, novel, scripted  # noqa: F401
