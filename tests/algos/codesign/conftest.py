"""The experiment of ``codesign_toys`` as it is when nothing disturbs it."""

import pytest
from codesign_toys import make_loop


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> str:
    loop = make_loop(tmp_path_factory.mktemp("whole"))
    loop.run()
    return loop.archive.digest()
