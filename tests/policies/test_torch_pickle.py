
import pytest

from deadreckon.errors import UserError
from deadreckon.policies.torch_pickle import load_network


@pytest.mark.parametrize(("module", "name"), [("os", "system"), ("builtins", "eval"), ("torch", "load")])
def test_networks_are_read_with_no_more_trust(tmp_path, module, name):
    path = tmp_path / "policy.pickle"
    path.write_bytes(b"\x80\x02c" + f"{module}\n{name}\n".encode() + b"X\x04\x00\x00\x00true\x85R.")
    with pytest.raises(UserError, match=f"refused: the pickle asks for {module}.{name}"):
        load_network(path)


def test_an_object_of_a_network_is_its_fields_and_a_name_stays_a_name(tmp_path):
    path = tmp_path / "policy.pickle"
    known = b"\x80\x02cmjrl.policies.gaussian_mlp\nMLP\n)\x81}X\x01\x00\x00\x00f"
    path.write_bytes(known + b"cbuiltins\ngetattr\nctorch._C\n_VariableFunctions\nX\x04\x00\x00\x00tanh\x86Rsb.")
    assert load_network(path) == {"f": "tanh"}
