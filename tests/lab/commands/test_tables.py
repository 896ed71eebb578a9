"""Tables of the benchmarks on the console, at any width."""

import numpy as np
from console_tables import check, rendered

from cep.commands.console import Table
from lab.bench.blind.report import blind_tables
from lab.bench.published_codes import CODE_HEAD
from lab.commands.tables import table_page


def test_the_tables_of_the_benchmarks_at_every_width():
    rng = np.random.default_rng(0)
    methods = (
        "pmp",
        "motdiff",
        "network",
        "psf-diffusion",
        "true path, uniform speed",
        "network:ddpm:1000",
    )
    names = ("mnc", "mnc_subpixel", "path_mnc", "psnr_db", "ssim", "cpu_s")
    figures = {
        (method, photo, motion, "bright"): {name: 10 * rng.random() for name in names}
        for method in methods
        for photo in "ab"
        for motion in "01"
    }
    made = list(table_page(blind_tables(figures, ["bright"], title="Blind", seed=0)))
    codes = [("mcdermott-moore-104", "52", "1.2345", "21.20", "1.3456", "20.11", "yes")]
    for one in [*made, Table("smallest |P|", CODE_HEAD, codes)]:
        check(one)
    assert all(rendered(one, 60).splitlines()[-1].count("n;") == 0 for one in made)
