"""Thousands of damaged mesh files in half a GiB: a surface that can be drawn, or a named error."""

import sys

import pytest

from tests.robots.mesh_files.test_mesh_files import fuzz

pytestmark = [pytest.mark.long, pytest.mark.timeout(1800)]


@pytest.mark.skipif(sys.platform != "linux", reason="needs limits of memory as on Linux")
def test_mutated_meshes(tmp_path):
    """6,000 mutated files of every kind."""
    read, refused = fuzz(300, 6300, tmp_path)
    assert read + refused == 6000
    assert min(read, refused) > 300
