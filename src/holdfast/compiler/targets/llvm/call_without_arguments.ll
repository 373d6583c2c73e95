; `function()` runs the kernel on the table in its record and returns the status as an integer.
define ptr @function(ptr %self, ptr %none) {
  %address = call ptr @PyTuple_GetItem(ptr %self, i64 0)
  %record = call ptr @PyLong_AsVoidPtr(ptr %address)
  %run = load ptr, ptr %record
  %table.at = getelementptr %record, ptr %record, i64 0, i32 1
  %table = load ptr, ptr %table.at
  %status = call i64 %run(ptr %table)
  %result = call ptr @PyLong_FromLongLong(i64 %status)
  ret ptr %result
}
