"""Programs of torch.export: their bits, and files of another form."""

import io
import json

import numpy as np
import pytest
import torch
from torch import nn

from minitouch_bench.errors import PolicyLoadError
from minitouch_bench.policies.policy import PolicySource, load_policy
from tests.archives import members, zipped

IMAGE, TOUCH = torch.zeros(1, 1, 84, 84, dtype=torch.uint8), torch.ones(1, 11)


class Reach(nn.Module):
    """Return what is asked for of the touch vector."""

    def forward(self, image, touch):
        return touch[:, :4]


def saved(module=None, arguments=(IMAGE, TOUCH), **options):
    buffer = io.BytesIO()
    torch.export.save(torch.export.export(module or Reach(), arguments, **options), buffer)
    return buffer.getvalue()


def refused(content, match):
    with pytest.raises(PolicyLoadError, match=match) as caught:
        load_policy(PolicySource("torch.export", "x", "x.pt2", content=content))
    assert len(str(caught.value)) < 600


def test_a_free_batch_axis_is_fine(observation):
    batch = {0: torch.export.Dim("batch", min=1)}
    two = IMAGE.repeat(2, 1, 1, 1), TOUCH.repeat(2, 1)
    content = saved(arguments=two, dynamic_shapes=(batch, batch))
    policy = load_policy(PolicySource("torch.export", "x", "x.pt2", content=content))
    assert np.array_equal(policy.act(observation)[0], observation["touch"][:4])


@pytest.mark.parametrize(
    ("arguments", "options"),
    [
        ((IMAGE.float(), TOUCH), {}),
        ((IMAGE, TOUCH[:, :5]), {}),
        ((), {"kwargs": {"image": IMAGE, "touch": TOUCH}}),
    ],
)
def test_a_program_of_other_inputs_is_refused(arguments, options):
    refused(saved(arguments=arguments, **options), r"Export \(image: uint8 \(1, 1, 84, 84\)")


def test_files_of_another_form_are_refused():
    whole = saved()
    weights = io.BytesIO()
    torch.save({"weight": torch.zeros(3)}, weights)
    for content in (b"plain text", whole[:-500], weights.getvalue()):
        refused(content, "cannot be read")
    library = {"archive/data/aotinductor/model/model.so": b"\x7fELF"}
    refused(zipped({**members(whole), **library}), "compiled code")


def test_a_file_of_a_later_torch_is_refused_with_our_version():
    contents = members(saved())
    (name,) = [name for name in contents if name.endswith("models/model.json")]
    program = json.loads(contents[name])
    program["schema_version"]["major"] += 1
    content = zipped({**contents, name: json.dumps(program)})
    refused(content, f"torch {torch.__version__.partition('+')[0]}.* version")
