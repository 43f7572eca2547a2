"""What results are noted with: the processor's model."""

import pytest

from deadreckon import versions


@pytest.mark.parametrize(
    ("told", "model"),
    [
        ("processor\t: 0\nmodel\t\t: 1\nmodel name\t: AMD EPYC 7B13\n\nprocessor\t: 1\nmodel name\t: other\n", "AMD EPYC 7B13"),
        ("processor\t: 0\nBogoMIPS\t: 50.00\n", "aarch64"),  # Linux on ARM
        (None, "aarch64"),  # another system
    ],
)
def test_the_processor_is_named_as_the_system_names_it(told, model, tmp_path, monkeypatch):
    file = tmp_path / "cpuinfo"
    if told is not None:
        file.write_text(told)
    monkeypatch.setattr(versions, "Path", lambda path: file)
    monkeypatch.setattr("platform.processor", lambda: "")
    monkeypatch.setattr("platform.machine", lambda: "aarch64")
    assert versions.cpu_model() == model
