"""Freed memory is kept inside, and goes back to the system afterwards."""

from __future__ import annotations

import gc
import platform

import numpy as np
import psutil
import pytest

from forearm_fem.fem.kernels.heap import give_back
from forearm_fem.pipeline.malloc import freed_memory_kept


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library than glibc")
def test_freed_memory_is_kept_until_the_end():
    gc.collect()
    process = psutil.Process()
    with freed_memory_kept():
        before = process.memory_info().rss
        block = np.ones(40_000_000)
        held = process.memory_info().rss
        del block
        kept = process.memory_info().rss
    after = process.memory_info().rss
    assert held - before > 0.9 * 320e6
    assert kept - before > 0.9 * 320e6
    assert after - before < 0.1 * 320e6


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library than glibc")
def test_freed_memory_under_what_still_lives_goes_back_when_asked():
    gc.collect()
    process = psutil.Process()
    with freed_memory_kept():
        block, above = np.ones(40_000_000), np.ones(1000)
        held = process.memory_info().rss
        del block
        give_back()
        assert held - process.memory_info().rss > 0.9 * 320e6
        assert above.sum() == 1000
