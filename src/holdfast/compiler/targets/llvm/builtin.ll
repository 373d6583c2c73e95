; The declarations that all Python builtins share: the record of one builtin, Python's buffers and Python's own
; functions. `builtin.py` appends either `call_without_arguments.ll` or `call_with_arrays.ll`.

%record = type { ptr, ptr, ptr, ptr, ptr, i64, i64, i64, ptr, i64, ptr, i64, ptr, ptr, i64, i64, ptr, [0 x %input] }
%input = type { i64, i64, i64, double, i64 }
; size in bytes, number of axes, length of the first, largest number (negative: not checked), whether it is a pose
; run, table, fallback, "out", expected result, begin and end of its memory, number of inputs, the type of arrays, how
; many inputs may be given by place, the names of all inputs (null for one without a name); which results are checked
; (0 none, 1 finite, 2 finite or +infinity), what copies the results of calls without `out` (null: none), what a user
; gets of such a copy (null: itself), begin and end of the memory of these calls, their table; the inputs
%buffer = type { ptr, ptr, i64, i64, i32, i32, ptr, ptr, ptr, ptr, ptr }
; buf, obj, len, itemsize, readonly, ndim, format, shape, strides, suboffsets, internal

declare ptr @PyTuple_GetItem(ptr, i64)
declare i64 @PyTuple_Size(ptr)
declare ptr @PyLong_AsVoidPtr(ptr)
declare ptr @PyLong_FromLongLong(i64)
declare i32 @PyObject_GetBuffer(ptr, ptr, i32)
declare void @PyBuffer_Release(ptr)
declare void @PyErr_Clear()
declare i32 @PyType_IsSubtype(ptr, ptr)
declare void @Py_IncRef(ptr)
declare void @Py_DecRef(ptr)
declare ptr @PyObject_CallNoArgs(ptr)
declare ptr @PyObject_Vectorcall(ptr, ptr, i64, ptr)
