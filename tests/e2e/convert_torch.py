# SPDX-License-Identifier: MIT
# What PyTorch says about files that `ernerf convert` read and wrote. Run by test_convert_torch.sh.
#   convert_torch.py same A.pth B.pth     B opens with weights_only=True and holds the same tree, bytes and types
#   convert_torch.py listed A.pth B.sft   every tensor of the model in A lies in B with the same bytes
#   convert_torch.py strict MODEL.PY A.pth [torso]   load_state_dict(strict=True) of the public program's model
#   convert_torch.py model A.pth B.pth    the same state dict, B opened with weights_only=True
#   convert_torch.py optimizer DIR A.pth STEP   PyTorch's AdamW and schedule go on from what A holds
#   convert_torch.py make DIR             files of kinds that the samples lack
import importlib.util, json, struct, sys
from collections import OrderedDict

import numpy as np
import torch


def raw(t):
    t = t.detach().contiguous()
    return t.view(torch.int16).numpy().tobytes() if t.dtype == torch.bfloat16 else t.numpy().tobytes()


def compare(a, b, path=""):
    if isinstance(a, torch.Tensor):
        assert isinstance(b, torch.Tensor) and a.dtype == b.dtype and a.shape == b.shape, (path, b)
        assert raw(a) == raw(b), (path, "bytes differ")
        return 1
    if isinstance(a, np.generic):
        a = a.item()
    if isinstance(a, float) and isinstance(b, torch.Tensor):  # no float opens with weights_only in PyTorch 1.13
        assert b.dtype == torch.float64 and b.dim() == 0, path
        b = b.item()
    assert type(a) is type(b), (path, type(a), type(b))
    if isinstance(a, dict):
        assert list(a) == list(b), (path, list(a), list(b))
        return sum(compare(a[k], b[k], f"{path}.{k}") for k in a)
    if isinstance(a, (list, tuple)):
        assert len(a) == len(b), path
        return sum(compare(x, y, f"{path}.{i}") for i, (x, y) in enumerate(zip(a, b)))
    assert a == b or (a != a and b != b), (path, a, b)
    return 0


def safetensors(path):
    data = open(path, "rb").read()
    length = struct.unpack("<Q", data[:8])[0]
    header = json.loads(data[8:8 + length])
    header.pop("__metadata__", None)
    return {k: (v["dtype"], v["shape"], data[8 + length + v["data_offsets"][0]:8 + length + v["data_offsets"][1]])
            for k, v in header.items()}


NAMES = {torch.float32: "F32", torch.float16: "F16", torch.bfloat16: "BF16", torch.float64: "F64", torch.uint8: "U8",
         torch.int8: "I8", torch.bool: "BOOL", torch.int16: "I16", torch.int32: "I32", torch.int64: "I64"}


def floats(tree):
    if isinstance(tree, (dict, list, tuple)):
        return any(floats(v) for v in (tree.values() if isinstance(tree, dict) else tree))
    return isinstance(tree, (float, bytes))


def listed(pth, sft):
    found, tree = safetensors(sft), torch.load(pth, map_location="cpu", weights_only=False)
    tree = tree["model"] if isinstance(tree, dict) and "model" in tree else tree
    for name, t in tree.items():
        dtype, shape, data = found[name]
        assert dtype == NAMES[t.dtype] and shape == list(t.shape) and data == raw(t), name
    print(len(tree), "tensors as PyTorch reads them")


def strict(source, pth, torso):
    spec = importlib.util.spec_from_file_location("reference", source)
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, source.rsplit("/", 1)[0])
    spec.loader.exec_module(module)
    state = torch.load(pth, map_location="cpu", weights_only=True)["model"]
    model = module.ERNeRF(levels=len(state["encoder_xy.offsets"]) - 1, torso=torso)
    print(model.load_state_dict(state, strict=True))


def model(a, b):
    a, b = torch.load(a, weights_only=False)["model"], torch.load(b, weights_only=True)["model"]
    print(compare(a, b), "tensors of the model the same")


def optimizer(folder, pth, step):
    sys.path.insert(0, folder)
    import full
    import ernerf_torch
    saved = torch.load(pth, weights_only=False)
    m = ernerf_torch.ERNeRF(levels=12)
    m.load_state_dict(saved["model"], strict=True)
    adam = torch.optim.AdamW(full.groups(m), betas=(0, 0.99), eps=1e-8)
    adam.load_state_dict(saved["optimizer"])
    schedule = torch.optim.lr_scheduler.LambdaLR(adam, lambda q: 0.5 ** (q / 100000))
    schedule.load_state_dict(saved["lr_scheduler"])
    for group in adam.param_groups:
        for p in group["params"]:
            one = adam.state[p]
            assert float(one["step"]) == step and one["exp_avg_sq"].shape == p.shape, p.shape
            assert bool((one["exp_avg_sq"] >= 0).all())
    moved = adam.state[m.sigma_net.net[0].weight]["exp_avg_sq"]
    assert bool((moved > 0).any())
    names = [n for n, _ in m.named_parameters()]
    assert len(saved["ema"]["shadow_params"]) == len(names)
    for p, s in zip(m.parameters(), saved["ema"]["shadow_params"]):
        assert p.shape == s.shape and float((p - s).abs().max()) < 0.2, p.shape
    sum(p.square().sum() for p in m.parameters()).backward()
    before = m.sigma_net.net[0].weight.detach().clone()
    adam.step()
    schedule.step()
    assert not torch.equal(before, m.sigma_net.net[0].weight)
    print("PyTorch's optimizer goes on from step", step)


def make(folder):
    torch.manual_seed(0)
    kinds = OrderedDict((str(d).split(".")[1], (torch.rand(3, 4) * 100).to(d)) for d in NAMES)
    base = torch.arange(60, dtype=torch.float32).reshape(3, 4, 5)
    kinds.update(transposed=base.permute(2, 0, 1), part=base[1:, ::2, 1:4], spread=torch.ones(1, 5).expand(7, 5),
                 empty=torch.zeros(0, 3), scalar=torch.tensor(7), tied=base, parameter=torch.nn.Parameter(base[0]))
    torch.save(kinds, f"{folder}/kinds.pth")
    torch.save(kinds, f"{folder}/kinds4.pth", pickle_protocol=4)
    tree = dict(stats=dict(results=[np.float64(1.5), np.float32(0.25), np.int64(-3), np.bool_(True)], best=float("inf"),
                           none=float("nan"), big=1 << 40, raw=b"\x00\xffab", text="\u00e9"),
                pair=(1, (2.5, None), []), lists=[torch.ones(2), [torch.zeros(3)]], model=kinds)
    torch.save(tree, f"{folder}/tree.pth")
    torch.save(kinds, f"{folder}/old.pth", _use_new_zipfile_serialization=False)


def main(words):
    if words[0] == "same":
        a = torch.load(words[1], map_location="cpu", weights_only=False)
        b = torch.load(words[2], map_location="cpu", weights_only=False)
        if not floats(b) or int(torch.__version__.split(".")[0]) >= 2:
            compare(b, torch.load(words[2], map_location="cpu", weights_only=True))
        elif "optimizer" not in b and "stats" not in b:
            raise AssertionError("floats, so that PyTorch 1.13 does not open it with weights_only=True")
        print(compare(a, b), "tensors the same")
    elif words[0] == "listed":
        listed(words[1], words[2])
    elif words[0] == "model":
        model(words[1], words[2])
    elif words[0] == "optimizer":
        optimizer(words[1], words[2], int(words[3]))
    elif words[0] == "strict":
        strict(words[1], words[2], len(words) > 3)
    else:
        make(words[1])


main(sys.argv[1:])
