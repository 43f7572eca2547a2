import pytest
from small_logs import make_log, variants


@pytest.fixture
def log():
    return make_log()


@pytest.fixture(params=list(variants()))
def variant(request):
    return variants()[request.param]
