"""Commands that are recorded, and what they need first."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from cep.restoration.registry import METHODS as RESTORATIONS
from hw.export import EXPORTERS


@dataclass(frozen=True)
class Case:
    """A command line, and how it is run.

    Attributes
    ----------
    name : str
        Command and form; the name of its folder in a record.
    argv : str
        Command line as typed in a shell; it begins with ``cep`` or ``python -m PACKAGE``.
    emulator : bool
        Whether an emulated controller runs beside it, at the port ``uno``.
    first : str
        Command line that is run before, in the same folder, and not recorded.
    """

    name: str
    argv: str
    emulator: bool = False
    first: str = ""


PREPARATION = [
    Case(
        "input-coded",
        "cep simulate sharp.png --trajectory path.json --code 110100101111 --photons 5000 -o"
        " coded.png",
    ),
    Case(
        "input-open",
        "cep simulate sharp.png --trajectory path.json --photons 20000 -o open.png",
    ),
    Case(
        "input-second",
        "cep simulate sharp.png --trajectory path.json --code 101111010011 --photons 5000 -o"
        " second.png",
    ),
    Case(
        "input-colour",
        "cep simulate colour.png --linear 12 --code 110100101111 --photons 5000 -o"
        " colour_coded.png",
    ),
    Case(
        "input-light",
        "cep simulate light.png --trajectory path.json --code 110100101111 --photons 9000 -o"
        " light_coded.png",
    ),
    Case("input-shots-a", "cep simulate sharp.png --linear 9 --photons 20000 -o shot_a.png"),
    Case(
        "input-shots-b",
        "cep simulate sharp.png --trajectory path.json --photons 20000 --seed 3 -o shot_b.png",
    ),
    Case("input-code", "cep optimize --linear 12 --chips 12 --open 6:9 --steps 2000 -o code.json"),
    Case("input-program", "cep export 110100101111 --format vcd --chip-ns 1000000 -o capture.vcd"),
]
"""Commands that make inputs, one after the other in one folder."""

FOLDER_PHOTOS = {"shot_a.png": "shots/a.png", "shot_b.png": "shots/b.png"}
"""Inputs that are copied into a folder of photos, without the PSFs beside them."""

SEARCH = "--steps 2000 --seed 1"

PATH_12 = "--trajectory path.json --chips 12"

CASES = [
    Case("version", "cep --version"),
    # advise
    Case(
        "advise-linear",
        "cep advise --linear 12 --chips 12 --exposure 1/30 --photons 3000 --read-noise 10",
    ),
    Case(
        "advise-linear-json",
        "cep advise --linear 12 --chips 12 --exposure 1/30 --photons 3000 --read-noise 10 --json",
    ),
    Case(
        "advise-path",
        "cep advise --trajectory path.json --chips 12 --camera aptina-mt9m031-8bit --exposure"
        " 20ms",
    ),
    Case(
        "advise-codes",
        "cep advise --linear 12 --chips 12 --code code.json --code 101111010011 --path-error"
        " 0.5 --json",
    ),
    Case(
        "advise-device",
        "cep advise --linear 12 --chips 12 --device sony-pregius --exposure 0.004 -o"
        " advice.png --table advice.csv",
    ),
    Case(
        "advise-chips-omitted",
        "cep advise --linear 10 --exposure 1/30 --camera video-8bit --json",
    ),
    # optimize
    Case("optimize-mse", f"cep optimize --linear 12 --chips 12 {SEARCH} -o code_new.json"),
    Case(
        "optimize-mse-json",
        f"cep optimize --linear 12 --chips 12 {SEARCH} -o code_new.json --json",
    ),
    Case(
        "optimize-path",
        f"cep optimize {PATH_12} {SEARCH} --exposure 1/30 -o code_new.json --json",
    ),
    Case(
        "optimize-chips-omitted",
        f"cep optimize --linear 10 {SEARCH} --exposure 20ms -o code_new.json",
    ),
    Case(
        "optimize-min-mtf",
        f"cep optimize {PATH_12} {SEARCH} --objective min-mtf -o code_new.json --json",
    ),
    Case(
        "optimize-flatness",
        f"cep optimize {PATH_12} {SEARCH} --objective flatness -o code_new.json --json",
    ),
    Case(
        "optimize-noise",
        f"cep optimize {PATH_12} {SEARCH} --objective noise -o code_new.json --json",
    ),
    Case(
        "optimize-mix",
        f"cep optimize --linear 12 --chips 12 --open 6 {SEARCH} --objective"
        " min-mtf:0.15,noise:1 -o code_new.json --json",
    ),
    Case(
        "optimize-duty",
        f"cep optimize {PATH_12} --open 40%:60% {SEARCH} -o code_new.json",
    ),
    Case(
        "optimize-open-range",
        f"cep optimize {PATH_12} --open 4:7 {SEARCH} --camera video-8bit -o code_new.json --json",
    ),
    Case(
        "optimize-limits",
        f"cep optimize --linear 16 --chips 16 {SEARCH} --min-open 2 --min-closed 2"
        " -o code_new.json --json",
    ),
    Case(
        "optimize-device",
        f"cep optimize {PATH_12} --device flc --exposure 1.2ms {SEARCH} -o code_new.json --json",
    ),
    Case(
        "optimize-uncertain",
        f"cep optimize {PATH_12} {SEARCH} --speed 0.9:1.1 -o code_new.json --json",
    ),
    Case("optimize-exact", "cep optimize --linear 14 --chips 14 --method exact -o code_new.json"),
    Case(
        "optimize-exact-json",
        "cep optimize --linear 14 --chips 14 --open 7 --method exact -o code_new.json --json",
    ),
    Case(
        "optimize-frames",
        f"python -m lab frames --linear 16 --frames 2 --chips 16 --open 8 {SEARCH} -o pair.json",
    ),
    Case(
        "optimize-frames-json",
        f"python -m lab frames {PATH_12} --frames 2 --open 6 {SEARCH} -o pair.json --json",
    ),
    # pareto
    Case(
        "pareto-no-motion",
        f"python -m lab pareto --chips 12 --open 4:8 {SEARCH} -o front.json --plot front.png",
    ),
    Case(
        "pareto-no-motion-json",
        f"python -m lab pareto --chips 12 --open 4:8 {SEARCH} -o front.json --json",
    ),
    Case(
        "pareto-linear",
        f"python -m lab pareto --linear 12 --chips 12 --open 4:8 {SEARCH} -o front.json"
        " --table front.tex",
    ),
    Case(
        "pareto-path-json",
        f"python -m lab pareto {PATH_12} --open 30%:70% {SEARCH} --camera video-8bit -o front.json"
        " --plot front.svg --json",
    ),
    # audit
    Case("audit-bits", "cep audit 1010000111000001010000110011110111010111001001100111 --flips 1"),
    Case("audit-published", "cep audit merl-31-t62 --flips 2"),
    Case("audit-published-json", "cep audit merl-31-t62 --flips 1 --json"),
    Case(
        "audit-code-path",
        "cep audit code.json --trajectory path.json -o audit.json --table audit.csv",
    ),
    Case(
        "audit-code-path-json",
        "cep audit code.json --trajectory path.json --camera video-8bit --json",
    ),
    Case("audit-certificate-json", "cep audit code.json --linear 12 --json"),
    Case(
        "audit-figure",
        "cep audit 110100101111 --linear 12 --figure own:figure --chip-ns 2000000",
    ),
    Case("audit-own-code", "cep audit own:code --flips 1 --json"),
    # mtf
    Case(
        "mtf-path",
        "cep mtf --trajectory path.json --code code.json --code barker-13 -o mtf.png --table"
        " mtf.csv",
    ),
    Case(
        "mtf-linear-json",
        "cep mtf --linear 12 --code 110100101111 --figure own:figure -o mtf.svg --json",
    ),
    Case("mtf-pdf", "cep mtf --linear 12 --code bdinr-8 -o mtf.pdf"),
    # simulate
    Case("simulate-linear", "cep simulate sharp.png --linear 12"),
    Case(
        "simulate-linear-json",
        "cep simulate sharp.png --linear 12 --camera sony-imx250 --seed 5 -o new.tif --json",
    ),
    Case(
        "simulate-linear-gamma",
        "cep simulate colour.png --linear 12 --code bdinr-8 --gamma 2.2 -o new.png",
    ),
    Case(
        "simulate-path-json",
        "cep simulate colour.png --trajectory path.json --code code.json --read-noise 20 -o"
        " new.png --json",
    ),
    # deblur
    Case(
        "deblur-auto",
        "cep deblur coded.png --trajectory path.json --code 110100101111 -o sharp_new.png",
    ),
    Case(
        "deblur-auto-json",
        "cep deblur coded.png --trajectory path.json --code 110100101111 -o sharp_new.png --json",
    ),
    *[
        Case(
            f"deblur-{method}",
            f"cep deblur colour_coded.png --linear 12 --code 110100101111 --method {method}"
            f"{' --photons 5000' if method in ('wiener', 'pnp') else ''} -o sharp_new.png --json",
        )
        for method in RESTORATIONS
    ],
    Case(
        "deblur-own",
        "cep deblur coded.png --linear 12 --code 110100101111 --method own:restore -o"
        " sharp_new.png",
    ),
    Case("deblur-psf", "cep deblur coded.png --psf coded_psf.npy -o sharp_new.png --json"),
    Case("deblur-open-path", "cep deblur open.png --trajectory path.json"),
    Case("deblur-blind-coded", "cep deblur coded.png --code 110100101111 -o sharp_new.png --json"),
    Case("deblur-blind-open", "cep deblur open.png"),
    Case("deblur-blind-sharp", "cep deblur sharp.png --json"),
    # calibrate
    Case("calibrate-pmp", "cep calibrate open.png --method pmp -o motion"),
    Case(
        "calibrate-pmp-json",
        "cep calibrate open.png --method pmp --gamma linear -o motion --json",
    ),
    Case("calibrate-pmp-several", "cep calibrate shot_b.png open.png --method pmp -o motion"),
    Case(
        "calibrate-pmp-folder",
        "cep calibrate shots --method pmp -o motions_new --workers 1",
    ),
    Case(
        "calibrate-pmp-folder-json",
        "cep calibrate shots --method pmp -o motions_new --workers 1 --json",
    ),
    Case("calibrate-motdiff-json", "cep calibrate open.png -o motion --json"),
    Case(
        "calibrate-reference",
        "cep calibrate open.png --method reference --sharp sharp.png -o motion",
    ),
    Case(
        "calibrate-reference-json",
        "cep calibrate open.png --method reference --sharp sharp.png -o motion --json",
    ),
    Case(
        "calibrate-point",
        "cep calibrate light_coded.png --method point --code 110100101111 -o motion --json",
    ),
    Case(
        "calibrate-gyro",
        "cep calibrate open.png --method gyro --gyro gyro.csv --focal 800 --start 0.5"
        " --exposure 1/20 -o motion",
    ),
    Case(
        "calibrate-gyro-json",
        "cep calibrate open.png --method gyro --gyro gyro.csv --focal 800 --start 0.5"
        " --exposure 50ms --gyro-axes right,up,back --gyro-unit rad -o motion --json",
    ),
    Case(
        "calibrate-coded",
        "cep calibrate open.png coded.png --code open --code 110100101111 -o motion",
    ),
    Case("calibrate-own", "cep calibrate open.png --method own:Estimator -o motion --json"),
    # calibration-set
    Case(
        "calibration-set-two",
        "cep calibration-set --photos 2 --chips 16 -o set --table set.csv",
    ),
    Case(
        "calibration-set-three-json",
        "cep calibration-set --photos 3 --chips 16 --device flc --format c -o set --json",
    ),
    Case(
        "calibrate-refined",
        "cep calibrate coded.png --code 110100101111 --trajectory path.json",
    ),
    Case(
        "calibrate-refined-two-json",
        "cep calibrate coded.png second.png --code 110100101111 --code 101111010011 --trajectory"
        " path.json -o better --json",
    ),
    # export
    *[Case(f"export-{form}", f"cep export code.json --format {form}") for form in EXPORTERS],
    Case(
        "export-device-json",
        "cep export 110100101111 --format arduino --chip-ns 1000001 --device cxp-avr -o"
        " new.ino --json",
    ),
    # camera
    Case("camera-list", "cep camera list --table cameras.md"),
    Case("camera-list-json", "cep camera list --json"),
    Case("camera-list-name", "cep camera list sony-imx250"),
    Case("camera-list-name-json", "cep camera list video-8bit --json"),
    Case(
        "camera-estimate",
        "cep camera estimate flat1a.png flat1b.png flat2a.png flat2b.png flat3a.png"
        " flat3b.png --dark dark1.png dark2.png -o camera.toml --table levels.csv",
    ),
    Case(
        "camera-estimate-json",
        "cep camera estimate flat1a.png flat1b.png flat2a.png flat2b.png flat3a.png"
        " flat3b.png --black 8 --bits 8 -o camera.json --plot curve.svg --json",
    ),
    # studio
    Case("studio-extract", "cep studio studio.json --extract design"),
    Case("studio-extract-json", "cep studio studio.json --extract design --json"),
    # demo
    Case(
        "demo-photo-json",
        "cep demo --photo open.png --chips 12 --camera video-8bit -o demo --json",
    ),
    # hardware
    Case("hw-info-ports-json", "cep hw info --json"),
    Case(
        "hw-verify-vcd",
        "cep hw verify 110100101111 --capture capture.vcd --chip-ns 1000000 --linear 12 -o"
        " played.json",
    ),
    Case(
        "hw-verify-vcd-json",
        "cep hw verify 110100101111 --vcd capture.vcd --trajectory path.json -o played.json"
        " --json",
    ),
    Case("hw-verify-csv", "cep hw verify 110100101111 --capture capture.csv --table plays.csv"),
    Case("hw-verify-differs", "cep hw verify 110100101110 --capture capture.vcd --json"),
    Case("hw-emulate", "cep hw emulate uno --link board --seconds 0.5"),
    Case("hw-info", "cep hw info --port uno", emulator=True),
    Case("hw-info-json", "cep hw info --port uno --json", emulator=True),
    Case(
        "upload-clock-json", "cep upload code.json --port uno --clock-ppm 20 --json", emulator=True
    ),
    Case("hw-trigger-empty", "cep hw trigger --port uno --json", emulator=True),
    Case(
        "hw-trigger",
        "cep hw trigger --port uno",
        emulator=True,
        first="cep upload code.json --port uno --arm",
    ),
    Case(
        "hw-verify-port",
        "cep hw verify code.json --port uno",
        emulator=True,
        first="cep upload code.json --port uno",
    ),
    Case("hw-calibrate", "cep hw calibrate --port uno --seconds 1", emulator=True),
    Case("hw-abort", "cep hw abort --port uno", emulator=True),
    Case("hw-info-watch", "cep hw info --port uno --watch 0.3", emulator=True),
    Case("hw-verify-port-empty", "cep hw verify code.json --port uno --json", emulator=True),
    Case("upload", "cep upload code.json --port uno", emulator=True),
    Case(
        "upload-arm-json",
        "cep upload code.json --port uno --arm --json",
        emulator=True,
    ),
    Case("upload-play-json", "cep upload code.json --port uno --play --json", emulator=True),
    # bench
    Case(
        "bench-blind",
        "python -m lab bench blind --data photos --protocol blind.toml --methods pmp"
        " --workers 1 -o blind",
    ),
    Case(
        "bench-blind-json",
        "python -m lab bench blind --data photos --protocol blind.toml --methods"
        " parametric,own:Estimator --workers 1 -o blind --json",
    ),
    Case(
        "bench-speed",
        "python -m lab bench speed --data photos --protocol blind.toml --methods"
        " own:Estimator -o speed",
    ),
    Case(
        "bench-cep",
        "python -m lab bench cep --data photos --protocol coded.toml --designs"
        " open,random,both-ways --workers 1 -o coded",
    ),
    Case(
        "bench-cep-json",
        "python -m lab bench cep --data photos --protocol coded.toml --designs dnf,oracle --code"
        " mine=own:code --set 'restoration=\"own:restore\"' --workers 1 -o coded --json",
    ),
    Case(
        "bench-codes",
        "python -m lab bench codes bdinr-8 --code mine=1101001 --time 1 --workers 1 -o codes",
    ),
    # python -m motdiff
    Case("motdiff-sample", "python -m motdiff sample open.png -o drawn.png --count 1 --steps 2"),
    Case("motdiff-pack", "python -m motdiff pack photos photos.zip --side 64"),
    Case("motdiff-prepare", "python -m motdiff prepare run.toml -o samples --shards 0:1"),
    Case(
        "motdiff-train",
        "python -m motdiff train run.toml -o run --device cpu --validate-every 2",
    ),
    # bad input
    Case("bad-no-command", "cep nonsense"),
    Case("bad-option", "cep mtf --nonsense 3"),
    Case("bad-missing-photo", "cep deblur missing.png --linear 12"),
    Case("bad-missing-photo-json", "cep deblur missing.png --linear 12 --json"),
    Case("bad-missing-code", "cep audit missing.json"),
    Case("bad-damaged-json", "cep audit damaged.json"),
    Case("bad-damaged-trajectory", "cep optimize --trajectory damaged.json --steps 10"),
    Case("bad-trajectory-order", "cep mtf --trajectory backwards.json --code bdinr-8"),
    Case("bad-schema", "cep audit path.json"),
    Case("bad-damaged-png", "cep deblur damaged.png --linear 12"),
    Case("bad-bits", "cep audit 10102"),
    Case("bad-bits-closed", "cep audit 0000"),
    Case("bad-bits-hostile", "cep export '$(touch ran)' --format c"),
    Case("bad-bits-long", "cep audit " + "10" * 3000),
    Case("bad-name", "cep audit raskar-53"),
    Case("bad-module", "cep audit nowhere:code"),
    Case("bad-motion-missing", "cep optimize --chips 12 --steps 10"),
    Case("bad-motion-twice", "cep optimize --linear 12 --trajectory path.json --steps 10"),
    Case("bad-open-share", "cep optimize --linear 12 --chips 12 --open 40%:6"),
    Case("bad-open-range", "cep optimize --linear 12 --chips 12 --open 9:40 --steps 10"),
    Case(
        "bad-objective",
        "cep optimize --linear 12 --chips 12 --objective nicest --steps 10 -o code_new.json",
    ),
    Case(
        "bad-exact-objective",
        "cep optimize --linear 12 --chips 12 --method exact --objective noise -o code_new.json",
    ),
    Case("bad-camera", "cep advise --linear 12 --camera kodak-brownie"),
    Case("bad-device", "cep export code.json --format csv --device guillotine"),
    Case("bad-format", "cep export code.json --format exe"),
    Case(
        "bad-device-too-fast",
        "cep export 110100101111 --format csv --chip-ns 1000 --device mechanical",
    ),
    Case("bad-method", "cep deblur coded.png --linear 12 --method magic"),
    Case("bad-psf-and-linear", "cep deblur coded.png --linear 12 --psf coded_psf.npy"),
    Case("bad-output-exists", "cep mtf --linear 12 --code bdinr-8 -o mtf_old.png"),
    Case("bad-output-suffix", "cep mtf --linear 12 --code bdinr-8 -o mtf.xyz"),
    Case("bad-output-folder", "cep mtf --linear 12 --code bdinr-8 -o nowhere/mtf.png"),
    Case("bad-calibrate-method", "cep calibrate open.png --method magic"),
    Case("bad-calibrate-reference", "cep calibrate open.png --method reference"),
    Case("bad-calibrate-codes", "cep calibrate open.png coded.png --code open"),
    Case(
        "bad-gyro",
        "cep calibrate open.png --method gyro --gyro own.py --focal 800 --start 0.5"
        " --exposure 1/20",
    ),
    Case("bad-calibrate-open", "cep calibrate open.png --code open --trajectory path.json"),
    Case("bad-camera-estimate", "cep camera estimate flat1a.png --dark dark1.png dark2.png"),
    Case("bad-studio", "cep studio path.json --extract design"),
    Case("bad-port", "cep upload code.json --port no_port"),
    Case(
        "bad-bench-method",
        "python -m lab bench blind --data photos --protocol blind.toml --methods magic",
    ),
    Case("bad-bench-data", "python -m lab bench --quick --data missing"),
    Case(
        "bad-bench-protocol",
        "python -m lab bench cep --data photos --protocol nobody --designs open",
    ),
    Case("bad-motdiff-config", "python -m motdiff train blind.toml -o run"),
    Case("bad-motdiff-command", "python -m motdiff eval"),
]
"""The cases, in the order of a record."""


def case_names(records: Iterable[Path]) -> list[str]:
    """Return the names of all cases of records, in the order of the table."""
    present = {path.parent.name for folder in records for path in folder.glob("*/files.json")}
    order = {case.name: number for number, case in enumerate([*PREPARATION, *CASES])}
    return sorted(present, key=lambda name: (order.get(name, len(order)), name))
