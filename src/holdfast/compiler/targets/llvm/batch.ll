; The function that runs a schedule for a batch: groups begin <= b < end of $lanes systems each, $together of them together
; as long as there are so many. Row k of `table` holds the address and the stride of external array k.

define void @batch(ptr %table, i64 %begin, i64 %end, i64 %count, i64 %repeats, ptr %arena) nounwind {
entry:
$strides
  %varied = icmp ne i64 $varied, 0  ; some parameter differs from system to system
  %any = icmp slt i64 %begin, %end
  br i1 %any, label %next, label %done

next:
  %b = phi i64 [ %begin, %entry ], [ %b.next, %computed ]
  %first = mul i64 %b, $lanes
  %left = sub i64 %end, %b
  %many = icmp sge i64 %left, $together
  %start = icmp eq i64 %b, %begin
  %needed = or i1 %start, %varied
  br i1 %needed, label %prepare, label %compute

prepare:
  %prepare.groups = select i1 %many, ptr @prepare.$together, ptr @prepare.1
  call void %prepare.groups(ptr %table, i64 %first, i64 %count, i64 %repeats, ptr %arena)
  br label %compute

compute:
  %compute.groups = select i1 %many, ptr @compute.$together, ptr @compute.1
  call void %compute.groups(ptr %table, i64 %first, i64 %count, i64 %repeats, ptr %arena)
  br label %computed

computed:
  %done.groups = select i1 %many, i64 $together, i64 1
  %b.next = add i64 %b, %done.groups
  %more = icmp slt i64 %b.next, %end
  br i1 %more, label %next, label %done

done:
  fence seq_cst  ; what went past the caches is there for other threads
  ret void
}
