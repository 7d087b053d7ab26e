import math

import torch

from prt.nn.encodings import log_roughness, one_blob


def test_one_blob_peaks_in_its_bin():
    code = one_blob(torch.tensor([[0.1, 0.9]]), 5)
    assert code.shape == (1, 10)
    assert code[0, :5].argmax() == 0 and code[0, 5:].argmax() == 4
    assert code[0, 0] == 1 and code[0, 9] == 1  # bin centres
    torch.testing.assert_close(code[0, 1], torch.tensor(math.exp(-0.5)))


def test_log_roughness():
    values = log_roughness(torch.tensor([0.0, 0.2, 1.0]))
    torch.testing.assert_close(values, torch.tensor([0.0, math.log(6) / math.log(26), 1.0]))
