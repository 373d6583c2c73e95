"""Environments for learning: tasks of arms that hold one object, for Gymnasium."""

from .carry import CarryTask as CarryTask
from .environments import Carry as Carry
from .environments import HandOver as HandOver
from .environments import PlaceOnTable as PlaceOnTable
from .hand_over import HandOverTask as HandOverTask
from .place_on_table import PlaceOnTableTask as PlaceOnTableTask
from .vector import CarryVector as CarryVector
from .vector import HandOverVector as HandOverVector
from .vector import PlaceOnTableVector as PlaceOnTableVector
