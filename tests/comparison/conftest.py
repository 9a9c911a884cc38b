from tests.reporting.conftest import hac, novel  # noqa: F401
