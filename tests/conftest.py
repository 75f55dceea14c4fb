"""The miniature study, run once for all tests that need a finished workflow."""

import pytest
from workflow_runs import workflow


@pytest.fixture(scope="session")
def finished_miniature(tmp_path_factory):
    """Folder with the results of tests/miniature.yaml. Tests copy it before they change anything."""
    folder = tmp_path_factory.mktemp("miniature")
    workflow(folder, "all")
    return folder
