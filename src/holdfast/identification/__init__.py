"""Identification of payloads, links, drives, friction and sensors from recorded motions."""

from holdfast.names import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
