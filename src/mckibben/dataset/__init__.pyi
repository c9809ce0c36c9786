from .isobaric import IsobaricDataset as IsobaricDataset
from .points import ExtractedPoints as ExtractedPoints
from .reading import read_dataset as read_dataset
from .reading import read_recording as read_recording
from .recipe import Recipe as Recipe
from .recording import Recording as Recording
