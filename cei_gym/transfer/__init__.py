"""A demonstration of one embodiment in, the same demonstration of another out (the paper's section IV)."""

from cei_gym.transfer.attempt import Attempt
from cei_gym.transfer.live import LiveTransfer
from cei_gym.transfer.options import METHODS, TransferOptions
from cei_gym.transfer.transfer import Transfer

__all__ = ["METHODS", "Attempt", "LiveTransfer", "Transfer", "TransferOptions"]
