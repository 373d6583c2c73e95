; `blank` writes NaN to the results of bad systems.

declare i1 @llvm.vector.reduce.or.v${lanes}i1(<$lanes x i1>)

define internal void @blank(ptr %x, i64 %n, <$lanes x i1> %bad) noinline nounwind {
entry:
  br label %next

next:
  %e = phi i64 [ 0, %entry ], [ %e.next, %next ]
  %k = mul i64 %e, $lanes
  %at = getelementptr double, ptr %x, i64 %k
  %v = load $T, ptr %at, align $align
  %w = select <$lanes x i1> %bad, $T $nan, $T %v
  store $T %w, ptr %at, align $align
  %e.next = add i64 %e, 1
  %more = icmp slt i64 %e.next, %n
  br i1 %more, label %next, label %done

done:
  ret void
}
