"""Files: problem cases, result folders."""

from .case_file import load_cases as load_cases
from .record_folder import load_record as load_record
from .tables import export_csv as export_csv
from .tables import export_parquet as export_parquet
