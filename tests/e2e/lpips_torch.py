# SPDX-License-Identifier: MIT
# LPIPS of ernerf/media.h, value and gradient, against PyTorch: AlexNet and VGG16 with made weights, as .pth files of both
# forms. Usage: lpips_torch.py FOLDER_OF_LIBRARIES WORK
import ctypes, sys

import numpy as np
import torch
import torch.nn.functional as F

ALEXNET = [(0, 3, 64, 11, 4, 2, 0), (3, 64, 192, 5, 1, 2, 3), (6, 192, 384, 3, 1, 1, 3), (8, 384, 256, 3, 1, 1, 0),
           (10, 256, 256, 3, 1, 1, 0)]
VGG16 = [(0, 3, 64, 3, 1, 1, 0), (2, 64, 64, 3, 1, 1, 0), (5, 64, 128, 3, 1, 1, 2), (7, 128, 128, 3, 1, 1, 0),
         (10, 128, 256, 3, 1, 1, 2), (12, 256, 256, 3, 1, 1, 0), (14, 256, 256, 3, 1, 1, 0), (17, 256, 512, 3, 1, 1, 2),
         (19, 512, 512, 3, 1, 1, 0), (21, 512, 512, 3, 1, 1, 0), (24, 512, 512, 3, 1, 1, 2), (26, 512, 512, 3, 1, 1, 0),
         (28, 512, 512, 3, 1, 1, 0)]
COMPARED = {"alexnet": [0, 3, 6, 8, 10], "vgg16": [2, 7, 14, 21, 28]}


def make(layers, compared):
    network, heads = {}, {}
    for n, i, o, k, _, _, _ in layers:
        most = (6 / (i * k * k)) ** 0.5
        network[f"features.{n}.weight"] = torch.empty(o, i, k, k).uniform_(-most, most)
        network[f"features.{n}.bias"] = torch.empty(o).uniform_(-0.1, 0.3)
        if n in compared:
            heads[f"lin{compared.index(n)}.model.1.weight"] = torch.rand(1, o, 1, 1)
    return network, heads


def distance(layers, compared, network, heads, x, y):
    shift = torch.tensor([-0.030, -0.088, -0.188], dtype=torch.float64)[:, None, None]
    scale = torch.tensor([0.458, 0.448, 0.450], dtype=torch.float64)[:, None, None]
    x, y, total = ((2 * x - 1 - shift) / scale)[None], ((2 * y - 1 - shift) / scale)[None], 0
    for n, _, _, _, stride, padding, pool in layers:
        weight, bias = (network[f"features.{n}.{name}"].double() for name in ("weight", "bias"))
        x, y = (F.relu(F.conv2d(F.max_pool2d(v, pool, 2) if pool else v, weight, bias, stride, padding)) for v in (x, y))
        if n in compared:
            f, g = (v / (v.square().sum(1, keepdim=True).sqrt() + 1e-10) for v in (x, y))
            total = total + ((f - g).square() * heads[f"lin{compared.index(n)}.model.1.weight"].double()).sum(1).mean()
    return total


def main(libraries, work):
    torch.manual_seed(3)
    core = ctypes.CDLL(f"{libraries}/libernerf.so", mode=ctypes.RTLD_GLOBAL)
    media = ctypes.CDLL(f"{libraries}/libernerf-media.so")
    core.ern_last_error.restype = ctypes.c_char_p
    context, lpips = ctypes.c_void_p(), ctypes.c_void_p()
    assert core.ern_context_create(ctypes.byref(context), None) == 0
    for name, layers in (("alexnet", ALEXNET), ("vgg16", VGG16)):
        network, heads = make(layers, COMPARED[name])
        torch.save(network, f"{work}/{name}.pth")
        torch.save(heads, f"{work}/{name}_heads.pth", _use_new_zipfile_serialization=False)
        status = media.ern_lpips_open(ctypes.byref(lpips), context, f"{work}/{name}.pth".encode(),
                                      f"{work}/{name}_heads.pth".encode())
        assert status == 0, core.ern_last_error(context)
        for height, width in ((32, 32), (64, 48), (71, 100)):
            x, y = torch.rand(2, 3, height, width)
            a, b = x.double().requires_grad_(), y.double()
            expected = distance(layers, COMPARED[name], network, heads, a, b)
            expected.backward()
            found, gradient = ctypes.c_double(), np.empty((3, height, width), np.float32)
            status = media.ern_lpips_distance(lpips, *(ctypes.c_void_p(v.numpy().ctypes.data) for v in (x, y)), width,
                                              height, ctypes.byref(found), ctypes.c_void_p(gradient.ctypes.data))
            assert status == 0, core.ern_last_error(context)
            apart = abs(found.value - expected.item()) / expected.item()
            gradients = np.abs(gradient - a.grad.numpy()).max() / a.grad.abs().max().item()
            print(f"{name} {width} x {height}: {found.value:.6f}, off by {apart:.1e}; gradient by {gradients:.1e} of its largest")
            assert apart < 1e-4 and gradients < 1e-4
        media.ern_lpips_free(ctypes.byref(lpips))


main(*sys.argv[1:])
