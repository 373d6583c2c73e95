; The function that runs a schedule for a batch: blocks begin <= b < end of $lanes systems each, `repeats` times in a
; row if the schedule has carried arrays. Row k of `table` holds the address and the stride of external array k.

define void @batch(ptr %table, i64 %begin, i64 %end, i64 %count, i64 %repeats, ptr %arena) nounwind {
entry:
  %scratch = getelementptr double, ptr %arena, i64 $scratch
  %last = sub i64 %count, 1
$addresses
  %varied = icmp ne i64 $strides, 0  ; some parameter differs from system to system
  %any = icmp slt i64 %begin, %end
  br i1 %any, label %next, label %done

next:
  %b = phi i64 [ %begin, %entry ], [ %b.next, %stored ]
  %first = mul i64 %b, $lanes
  %start = icmp eq i64 %b, %begin
  %needed = or i1 %start, %varied
  br i1 %needed, label %prepare, label %compute

prepare:
$prepare
  br label %compute

compute:
$compute
  br label %stored

stored:
  %b.next = add i64 %b, 1
  %more = icmp slt i64 %b.next, %end
  br i1 %more, label %next, label %done

done:
  fence seq_cst  ; what went past the caches is there for other threads
  ret void
}
