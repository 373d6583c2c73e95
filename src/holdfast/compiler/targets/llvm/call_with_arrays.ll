; `function(x0, x1, ..., *, name=x, ..., out=result)` runs the kernel on the inputs' buffers and returns `result`; without
; `out`, it returns what `copy` and `shown` make of memory of its own. Any other call is passed to the fallback. Inputs
; may be given by place or by name, names in any order.
;
; Acquiring or releasing a buffer may run Python code, which may call the same builtin. Hence the table is written only
; after all buffers have been acquired, and no Python code can run between that and the kernel, or the copy.
define ptr @function(ptr %self, ptr %args, i64 %given, ptr %names) {
  %address = call ptr @PyTuple_GetItem(ptr %self, i64 0)
  %record = call ptr @PyLong_AsVoidPtr(ptr %address)
  %count.at = getelementptr %record, ptr %record, i64 0, i32 7
  %count = load i64, ptr %count.at
  %placed.at = getelementptr %record, ptr %record, i64 0, i32 9
  %placed = load i64, ptr %placed.at
  %few = icmp ule i64 %given, %placed
  br i1 %few, label %begin, label %slow

begin:
  %unnamed = icmp eq ptr %names, null
  br i1 %unnamed, label %keyword, label %named

named:
  %listed = call i64 @PyTuple_Size(ptr %names)
  br label %keyword

keyword:
  %wanted = phi i64 [ 0, %begin ], [ %listed, %named ]
  %word.at = getelementptr %record, ptr %record, i64 0, i32 3
  %word = load ptr, ptr %word.at
  %array.at = getelementptr %record, ptr %record, i64 0, i32 8
  %array = load ptr, ptr %array.at
  %words.at = getelementptr %record, ptr %record, i64 0, i32 10
  %words = load ptr, ptr %words.at
  %all = add i64 %count, 1  ; the inputs and `out`
  %with.out = sub i64 %all, %given
  %without.out = sub i64 %count, %given
  %fits.with = icmp eq i64 %wanted, %with.out
  %fits.without = icmp eq i64 %wanted, %without.out
  %right.keywords = or i1 %fits.with, %fits.without
  br i1 %right.keywords, label %take, label %slow

take:
  %views = alloca %buffer, i64 %count, align 8
  %order = alloca ptr, i64 %all, align 8  ; what was given, in the record's order, and `out`
  br label %copy

copy:
  %b = phi i64 [ 0, %take ], [ %b.next, %copied ]
  %b.next = add i64 %b, 1
  %to.at = getelementptr ptr, ptr %order, i64 %b
  %by.place = icmp ult i64 %b, %given
  br i1 %by.place, label %copy.one, label %copied

copy.one:
  %arg.at = getelementptr ptr, ptr %args, i64 %b
  %arg = load ptr, ptr %arg.at
  br label %copied

copied:
  %content = phi ptr [ null, %copy ], [ %arg, %copy.one ]
  store ptr %content, ptr %to.at
  %copied.all = icmp eq i64 %b, %count
  br i1 %copied.all, label %name, label %copy

name:
  %n = phi i64 [ 0, %copied ], [ %n.next, %known ]
  %n.next = add i64 %n, 1
  %named.all = icmp eq i64 %n, %wanted
  br i1 %named.all, label %complete, label %seek

seek:
  %this = call ptr @PyTuple_GetItem(ptr %names, i64 %n)
  %is.out = icmp eq ptr %this, %word
  br i1 %is.out, label %known, label %compare

compare:
  %c = phi i64 [ %given, %seek ], [ %c.next, %other.word ]
  %c.next = add i64 %c, 1
  %last.word = icmp eq i64 %c, %count
  br i1 %last.word, label %slow, label %against

against:
  %candidate.at = getelementptr ptr, ptr %words, i64 %c
  %candidate = load ptr, ptr %candidate.at
  %matches = icmp eq ptr %this, %candidate
  br i1 %matches, label %known, label %other.word

other.word:
  br label %compare

known:
  %place.of = phi i64 [ %c, %against ], [ %count, %seek ]
  %value.place = add i64 %given, %n
  %value.at = getelementptr ptr, ptr %args, i64 %value.place
  %value = load ptr, ptr %value.at
  %ordered.at = getelementptr ptr, ptr %order, i64 %place.of
  store ptr %value, ptr %ordered.at
  br label %name

complete:
  %out.at = getelementptr ptr, ptr %order, i64 %count
  %out = load ptr, ptr %out.at
  %own = icmp eq ptr %out, null
  %copy.at = getelementptr %record, ptr %record, i64 0, i32 12
  %copier = load ptr, ptr %copy.at
  %copies = icmp ne ptr %copier, null
  %expected.at = getelementptr %record, ptr %record, i64 0, i32 4
  %expected.early = load ptr, ptr %expected.at
  %likely.same = icmp eq ptr %out, %expected.early
  %worth = select i1 %own, i1 %copies, i1 %likely.same
  br i1 %worth, label %more, label %slow

more:
  %i = phi i64 [ 0, %complete ], [ %i.next, %second ]
  %i.next = add i64 %i, 1
  %taken.all = icmp eq i64 %i, %count
  br i1 %taken.all, label %ready, label %next

next:
  %x.at = getelementptr ptr, ptr %order, i64 %i
  %x = load ptr, ptr %x.at
  %absent = icmp eq ptr %x, null
  br i1 %absent, label %release, label %kind

kind:
  %type.at = getelementptr i8, ptr %x, i64 $type_offset
  %type = load ptr, ptr %type.at
  %plain = icmp eq ptr %type, %array
  br i1 %plain, label %acquire, label %other

other:  ; what derives from arrays may mean more than its buffer, such as one with a mask
  %derived = call i32 @PyType_IsSubtype(ptr %type, ptr %array)
  %more.than.numbers = icmp ne i32 %derived, 0
  br i1 %more.than.numbers, label %release, label %acquire

acquire:
  %view = getelementptr %buffer, ptr %views, i64 %i
  %failed = call i32 @PyObject_GetBuffer(ptr %x, ptr %view, i32 12)  ; format, C order
  %taken = icmp eq i32 %failed, 0
  br i1 %taken, label %check, label %refused

refused:
  call void @PyErr_Clear()
  br label %release

check:
  %start = load ptr, ptr %view
  %start.number = ptrtoint ptr %start to i64
  %misaligned = and i64 %start.number, 7
  %bytes.at = getelementptr %buffer, ptr %view, i64 0, i32 2
  %bytes = load i64, ptr %bytes.at
  %size.at = getelementptr %record, ptr %record, i64 0, i32 17, i64 %i, i32 0
  %size = load i64, ptr %size.at
  %axes.at = getelementptr %record, ptr %record, i64 0, i32 17, i64 %i, i32 1
  %axes = load i64, ptr %axes.at
  %rows.at = getelementptr %record, ptr %record, i64 0, i32 17, i64 %i, i32 2
  %rows = load i64, ptr %rows.at
  %ndim.at = getelementptr %buffer, ptr %view, i64 0, i32 5
  %ndim = load i32, ptr %ndim.at
  %format.at = getelementptr %buffer, ptr %view, i64 0, i32 6
  %format = load ptr, ptr %format.at
  %aligned = icmp eq i64 %misaligned, 0
  %right.size = icmp eq i64 %bytes, %size
  %ndim.long = zext i32 %ndim to i64
  %right.axes = icmp eq i64 %ndim.long, %axes
  %described = icmp ne ptr %format, null
  %and.1 = and i1 %aligned, %right.size
  %and.2 = and i1 %right.axes, %described
  %and.3 = and i1 %and.1, %and.2
  br i1 %and.3, label %first, label %release

first:  ; of one or two axes, the number of rows and the size in all say the shape
  %shape.at = getelementptr %buffer, ptr %view, i64 0, i32 7
  %shape = load ptr, ptr %shape.at
  %length.first = load i64, ptr %shape
  %right.rows = icmp eq i64 %length.first, %rows
  %letter = load i8, ptr %format
  %double = icmp eq i8 %letter, 100  ; d
  %and.4 = and i1 %right.rows, %double
  br i1 %and.4, label %second, label %release

second:
  %after.at = getelementptr i8, ptr %format, i64 1
  %after = load i8, ptr %after.at
  %whole = icmp eq i8 %after, 0
  br i1 %whole, label %more, label %release

ready:
  %expected = load ptr, ptr %expected.at
  %begin.out.at = getelementptr %record, ptr %record, i64 0, i32 5
  %begin.out = load i64, ptr %begin.out.at
  %end.out.at = getelementptr %record, ptr %record, i64 0, i32 6
  %end.out = load i64, ptr %end.out.at
  %begin.own.at = getelementptr %record, ptr %record, i64 0, i32 14
  %begin.own = load i64, ptr %begin.own.at
  %end.own.at = getelementptr %record, ptr %record, i64 0, i32 15
  %end.own = load i64, ptr %end.own.at
  %run = load ptr, ptr %record
  %table.out.at = getelementptr %record, ptr %record, i64 0, i32 1
  %table.out = load ptr, ptr %table.out.at
  %table.own.at = getelementptr %record, ptr %record, i64 0, i32 16
  %table.own = load ptr, ptr %table.own.at
  %begin.memory = select i1 %own, i64 %begin.own, i64 %begin.out
  %end = select i1 %own, i64 %end.own, i64 %end.out
  %table = select i1 %own, ptr %table.own, ptr %table.out
  %finite.at = getelementptr %record, ptr %record, i64 0, i32 11
  %finite = load i64, ptr %finite.at
  %same.out = icmp eq ptr %out, %expected
  %same = or i1 %own, %same.out
  br i1 %same, label %place, label %release

place:
  %j = phi i64 [ 0, %ready ], [ %j.next, %write ], [ %j.next, %pose ], [ %j.next, %quaternion ]
  %j.next = add i64 %j, 1
  %placed.all = icmp eq i64 %j, %count
  br i1 %placed.all, label %compute, label %apart

apart:
  %input = getelementptr %buffer, ptr %views, i64 %j
  %from = load i64, ptr %input
  %length.at = getelementptr %buffer, ptr %input, i64 0, i32 2
  %length = load i64, ptr %length.at
  %to = add i64 %from, %length
  %before = icmp ule i64 %to, %begin.memory
  %behind = icmp uge i64 %from, %end
  %clear = or i1 %before, %behind
  br i1 %clear, label %write, label %release

write:
  %entry = getelementptr i64, ptr %table, i64 %j
  store i64 %from, ptr %entry
  %largest.at = getelementptr %record, ptr %record, i64 0, i32 17, i64 %j, i32 3
  %largest = load double, ptr %largest.at
  %checked = fcmp oge double %largest, 0.0
  br i1 %checked, label %numbers, label %place

numbers:  ; all are at most the largest in size, which no NaN is
  %source = inttoptr i64 %from to ptr
  %numbers.all = lshr i64 %length, 3
  br label %number

number:
  %k = phi i64 [ 0, %numbers ], [ %k.next, %sound ]
  %k.next = add i64 %k, 1
  %checked.all = icmp eq i64 %k, %numbers.all
  br i1 %checked.all, label %pose, label %measure

measure:
  %number.at = getelementptr double, ptr %source, i64 %k
  %number.here = load double, ptr %number.at
  %absolute = call double @llvm.fabs.f64(double %number.here)
  %within = fcmp ole double %absolute, %largest
  br i1 %within, label %sound, label %release

sound:
  br label %number

pose:
  %pose.at = getelementptr %record, ptr %record, i64 0, i32 17, i64 %j, i32 4
  %is.pose = load i64, ptr %pose.at
  %posed = icmp ne i64 %is.pose, 0
  br i1 %posed, label %quaternion, label %place

quaternion:
  %four = load <4 x double>, ptr %source, align 8
  %squares = fmul <4 x double> %four, %four
  %square = call double @llvm.vector.reduce.fadd.v4f64(double 0.0, <4 x double> %squares)
  %off = fsub double %square, 1.0
  %off.size = call double @llvm.fabs.f64(double %off)
  %unit = fcmp ole double %off.size, 1.9e-6  ; stricter than the fallback, which decides
  br i1 %unit, label %place, label %release

compute:
  %status = call i64 %run(ptr %table)
  %well = icmp eq i64 %status, 0
  br i1 %well, label %judge, label %release

judge:
  %unjudged = icmp eq i64 %finite, 0
  br i1 %unjudged, label %answer, label %results

results:
  %results.first = inttoptr i64 %begin.memory to ptr
  %results.bytes = sub i64 %end, %begin.memory
  %results.all = lshr i64 %results.bytes, 3
  %unlimited = icmp eq i64 %finite, 2
  br label %result

result:
  %r = phi i64 [ 0, %results ], [ %r.next, %good ]
  %r.next = add i64 %r, 1
  %judged.all = icmp eq i64 %r, %results.all
  br i1 %judged.all, label %answer, label %one

one:
  %result.at = getelementptr double, ptr %results.first, i64 %r
  %result.here = load double, ptr %result.at
  %difference = fsub double %result.here, %result.here
  %is.finite = fcmp oeq double %difference, 0.0
  %is.above = fcmp oeq double %result.here, 0x7FF0000000000000
  %may.be = and i1 %is.above, %unlimited
  %is.good = or i1 %is.finite, %may.be
  br i1 %is.good, label %good, label %release

good:
  br label %result

answer:
  br i1 %own, label %duplicate, label %release

duplicate:
  %duplicated = call ptr @PyObject_CallNoArgs(ptr %copier)
  br label %release

release:
  %done = phi i1 [ false, %next ], [ false, %other ], [ false, %refused ], [ false, %check ], [ false, %first ], [ false, %second ],
                 [ false, %ready ], [ false, %apart ], [ false, %measure ], [ false, %quaternion ], [ false, %compute ], [ false, %one ],
                 [ true, %answer ], [ true, %duplicate ]
  %held = phi i64 [ %i, %next ], [ %i, %other ], [ %i, %refused ], [ %i.next, %check ], [ %i.next, %first ], [ %i.next, %second ],
                  [ %count, %ready ], [ %count, %apart ], [ %count, %measure ], [ %count, %quaternion ], [ %count, %compute ], [ %count, %one ],
                  [ %count, %answer ], [ %count, %duplicate ]
  %found.own = phi ptr [ null, %next ], [ null, %other ], [ null, %refused ], [ null, %check ], [ null, %first ], [ null, %second ],
                       [ null, %ready ], [ null, %apart ], [ null, %measure ], [ null, %quaternion ], [ null, %compute ], [ null, %one ],
                       [ null, %answer ], [ %duplicated, %duplicate ]
  br label %drop

drop:
  %left = phi i64 [ %held, %release ], [ %last, %let.go ]
  %none = icmp eq i64 %left, 0
  br i1 %none, label %finish, label %let.go

let.go:
  %last = sub i64 %left, 1
  %old = getelementptr %buffer, ptr %views, i64 %last
  call void @PyBuffer_Release(ptr %old)
  br label %drop

finish:
  br i1 %done, label %return, label %slow

return:
  br i1 %own, label %made, label %given.back

given.back:
  call void @Py_IncRef(ptr %out)
  ret ptr %out

made:
  %shown.at = getelementptr %record, ptr %record, i64 0, i32 13
  %shown = load ptr, ptr %shown.at
  %plain.copy = icmp eq ptr %shown, null
  %nothing = icmp eq ptr %found.own, null
  %as.it.is = or i1 %plain.copy, %nothing
  br i1 %as.it.is, label %handed, label %show

handed:
  ret ptr %found.own

show:
  %argument = alloca ptr, align 8
  store ptr %found.own, ptr %argument
  %shown.of = call ptr @PyObject_Vectorcall(ptr %shown, ptr %argument, i64 1, ptr null)
  call void @Py_DecRef(ptr %found.own)
  ret ptr %shown.of

slow:
  %fallback.at = getelementptr %record, ptr %record, i64 0, i32 2
  %fallback = load ptr, ptr %fallback.at
  %found = call ptr @PyObject_Vectorcall(ptr %fallback, ptr %args, i64 %given, ptr %names)
  ret ptr %found
}

declare double @llvm.fabs.f64(double)
declare double @llvm.vector.reduce.fadd.v4f64(double, <4 x double>)
