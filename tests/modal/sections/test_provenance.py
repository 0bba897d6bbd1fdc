import pytest

from modal.sections.provenance import fingerprints
from okid.errors import InvalidDataError


def test_the_hash_is_that_of_the_standard(tmp_path):
    """FIPS 180-4, example of one block: SHA-256 of "abc"."""
    path = tmp_path / "a b.csv"
    path.write_bytes(b"abc")
    (file,) = fingerprints([path])
    assert (file.name, file.size) == (str(path), 3)
    assert file.sha256 == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


def test_a_file_that_is_gone_is_named(tmp_path):
    with pytest.raises(InvalidDataError, match=r"gone\.csv' cannot be read again for its hash"):
        fingerprints([tmp_path / "gone.csv"])
