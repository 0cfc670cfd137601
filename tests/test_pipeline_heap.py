"""Freed memory is kept inside, and goes back to the system afterwards."""

from __future__ import annotations

import gc
import platform

import numpy as np
import psutil
import pytest

from forearm_fem.fem.kernels.compiled import freed_memory_kept, give_back


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library than glibc")
def test_freed_memory_is_kept_until_the_end():
    gc.collect()
    process = psutil.Process()
    with freed_memory_kept():
        give_back()  # up to 64 MB that earlier tests freed may be kept, and would be taken first
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


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library than glibc")
def test_arrays_of_a_megabyte_do_not_cost_fresh_pages_each_time_after_a_solve():
    """glibc, once told any threshold, maps all that is larger than 128 kB anew for good, unless it is told more."""
    from resource import RUSAGE_SELF, getrusage

    with freed_memory_kept():
        pass
    before, times, pages = getrusage(RUSAGE_SELF).ru_minflt, 100, 256
    for _ in range(times):
        np.ones(pages * 4096 // 8)
    assert getrusage(RUSAGE_SELF).ru_minflt - before < 0.1 * times * pages  # once would be .01
