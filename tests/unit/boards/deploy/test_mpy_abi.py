"""Bytecode that a firmware does not load is named, with the file and the remedy."""

import pytest

from uros.boards.builder.compiler import bytecode
from uros.boards.builder.errors import CompilerError
from uros.boards.deploy.mpy_abi import misfit

ARMV6M, ARMV7EMSP, XTENSAWIN = 4, 7, 10


def header(architecture=0, sub_version=0, version=6):
    return bytes((ord("M"), version, architecture << 2 | sub_version, 31)) + b"rest"


def firmware(architecture=0, sub_version=3, version=6):
    return version | (architecture << 2 | sub_version) << 8


@pytest.mark.parametrize(
    ("mpy", "file", "fault"),
    [
        (firmware(), bytecode("x = 1\n", "x", "x"), ""),
        (firmware(XTENSAWIN), header(), ""),
        (firmware(), header(sub_version=1), ""),  # the sub-version is that of machine code
        (firmware(XTENSAWIN), header(XTENSAWIN, 3), ""),
        (firmware(ARMV7EMSP), header(ARMV6M, 3), ""),  # Thumb code of the smaller core
        (firmware(version=5), header(), "of version 6, and MicroPython 1.2 on the board reads"
         " version 5: flash MicroPython 1.27, or leave --mpy out"),
        (None, header(), "reads none: flash"),
        (firmware(), header(version=5), "is bytecode of version 5"),
        (firmware(ARMV6M), header(ARMV7EMSP, 3),
         "has machine code for armv7emsp, and MicroPython 1.2 on the board loads that for armv6m:"
         " build it for armv6m, or take the module as text"),
        (firmware(XTENSAWIN), header(ARMV6M, 3), "for armv6m, and"),
        (firmware(), header(XTENSAWIN, 3), "loads that for none: take the module as text"),
        (firmware(), header(15, 3), "has machine code for architecture 15"),
        (firmware(ARMV6M, 3), header(ARMV6M, 2),
         "has machine code of version 6.2, and MicroPython 1.2 on the board loads 6.3: build it"),
        (firmware(), b"", "is no bytecode of MicroPython"),
        (firmware(), b"print('text')", "is no bytecode of MicroPython"),
        (firmware(), b"M\6\0", "is no bytecode of MicroPython"),
    ],
)  # fmt: skip
def test_a_file_that_does_not_fit_is_named(mpy, file, fault):
    files = {"main.py": b"", "a.mpy": header(), "lib/b.mpy": file, "c.txt": b"M"}
    if mpy is None or mpy & 0xFF != 6:
        del files["a.mpy"]
    said = misfit(mpy, "1.2", files)
    assert (fault in said and said.startswith("lib/b.mpy")) if fault else said == ""


def test_files_of_text_need_no_bytecode():
    assert misfit(None, "1.2", {"main.py": b"", "a.txt": b"M\5"}) == ""


@pytest.mark.parametrize("name", ["native", "viper"])
def test_machine_code_in_a_program_is_explained(name):
    text = f"import micropython\n@micropython.{name}\ndef f():\n    return 1\n"
    with pytest.raises(CompilerError, match=r"fast\.py: @micropython\.native, .* leave --mpy out"):
        bytecode(text, "fast.py", "fast.py")
